.class Ldressi/sample/MainActivity$6;
.super Ljava/lang/Thread;


# annotations
.annotation system Ldalvik/annotation/EnclosingMethod;
    value = Ldressi/sample/MainActivity;->capture()V
.end annotation

.annotation system Ldalvik/annotation/InnerClass;
    accessFlags = 0x0
    name = null
.end annotation


# instance fields
.field final synthetic this$0:Ldressi/sample/MainActivity;

.field final synthetic val$date:Ljava/lang/String;

.field final synthetic val$file:Ljava/io/File;


# direct methods
.method constructor <init>(Ldressi/sample/MainActivity;Ljava/lang/String;Ljava/io/File;Ljava/lang/String;)V
    .registers 5

    iput-object p1, p0, Ldressi/sample/MainActivity$6;->this$0:Ldressi/sample/MainActivity;

    iput-object p3, p0, Ldressi/sample/MainActivity$6;->val$file:Ljava/io/File;

    iput-object p4, p0, Ldressi/sample/MainActivity$6;->val$date:Ljava/lang/String;

    invoke-direct {p0, p2}, Ljava/lang/Thread;-><init>(Ljava/lang/String;)V

    return-void
.end method


# virtual methods
.method public run()V
    .registers 5

    :try_start_0
    new-instance v1, Ldressi/Device;

    const/4 v0, 0x0

    invoke-direct {v1, v0}, Ldressi/Device;-><init>(Ljava/lang/String;)V
    :try_end_6
    .catch Ldressi/DressiException; {:try_start_0 .. :try_end_6} :catch_60
    .catch Ljava/io/IOException; {:try_start_0 .. :try_end_6} :catch_7e

    :try_start_6
    new-instance v2, Ljava/io/FileOutputStream;

    iget-object v0, p0, Ldressi/sample/MainActivity$6;->val$file:Ljava/io/File;

    invoke-direct {v2, v0}, Ljava/io/FileOutputStream;-><init>(Ljava/io/File;)V
    :try_end_d
    .catch Ljava/lang/Throwable; {:try_start_6 .. :try_end_d} :catch_5b
    .catch Ldressi/DressiException; {:try_start_6 .. :try_end_d} :catch_60
    .catch Ljava/io/IOException; {:try_start_6 .. :try_end_d} :catch_7e

    :try_start_d
    const-string v0, "captured"

    iget-object v3, p0, Ldressi/sample/MainActivity$6;->val$date:Ljava/lang/String;

    invoke-virtual {v1, v0, v3}, Ldressi/Device;->profile(Ljava/lang/String;Ljava/lang/String;)Ljava/lang/String;

    move-result-object v0

    const-string v3, "UTF-8"

    invoke-virtual {v0, v3}, Ljava/lang/String;->getBytes(Ljava/lang/String;)[B

    move-result-object v0

    invoke-virtual {v2, v0}, Ljava/io/FileOutputStream;->write([B)V

    new-instance v0, Ljava/lang/StringBuilder;

    invoke-direct {v0}, Ljava/lang/StringBuilder;-><init>()V

    const-string v3, "profile of "

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v1}, Ldressi/Device;->name()Ljava/lang/String;

    move-result-object v3

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    const-string v3, ": "

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    iget-object v3, p0, Ldressi/sample/MainActivity$6;->val$file:Ljava/io/File;

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/Object;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;
    :try_end_40
    .catch Ljava/lang/Throwable; {:try_start_d .. :try_end_40} :catch_56
    .catch Ldressi/DressiException; {:try_start_d .. :try_end_40} :catch_60
    .catch Ljava/io/IOException; {:try_start_d .. :try_end_40} :catch_7e

    move-result-object v0

    :try_start_41
    invoke-virtual {v2}, Ljava/io/FileOutputStream;->close()V
    :try_end_44
    .catch Ljava/lang/Throwable; {:try_start_41 .. :try_end_44} :catch_5b
    .catch Ldressi/DressiException; {:try_start_41 .. :try_end_44} :catch_60
    .catch Ljava/io/IOException; {:try_start_41 .. :try_end_44} :catch_7e

    :try_start_44
    invoke-virtual {v1}, Ldressi/Device;->close()V
    :try_end_47
    .catch Ldressi/DressiException; {:try_start_44 .. :try_end_47} :catch_60
    .catch Ljava/io/IOException; {:try_start_44 .. :try_end_47} :catch_7e

    :goto_47
    iget-object v1, p0, Ldressi/sample/MainActivity$6;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->screen:Landroid/os/Handler;
    invoke-static {v1}, Ldressi/sample/MainActivity;->access$400(Ldressi/sample/MainActivity;)Landroid/os/Handler;

    move-result-object v1

    new-instance v2, Ldressi/sample/MainActivity$6$1;

    invoke-direct {v2, p0, v0}, Ldressi/sample/MainActivity$6$1;-><init>(Ldressi/sample/MainActivity$6;Ljava/lang/String;)V

    invoke-virtual {v1, v2}, Landroid/os/Handler;->post(Ljava/lang/Runnable;)Z

    return-void

    :catch_56
    move-exception v0

    :try_start_57
    invoke-virtual {v2}, Ljava/io/FileOutputStream;->close()V
    :try_end_5a
    .catch Ljava/lang/Throwable; {:try_start_57 .. :try_end_5a} :catch_79
    .catch Ldressi/DressiException; {:try_start_57 .. :try_end_5a} :catch_60
    .catch Ljava/io/IOException; {:try_start_57 .. :try_end_5a} :catch_7e

    :goto_5a
    :try_start_5a
    throw v0
    :try_end_5b
    .catch Ljava/lang/Throwable; {:try_start_5a .. :try_end_5b} :catch_5b
    .catch Ldressi/DressiException; {:try_start_5a .. :try_end_5b} :catch_60
    .catch Ljava/io/IOException; {:try_start_5a .. :try_end_5b} :catch_7e

    :catch_5b
    move-exception v0

    :try_start_5c
    invoke-virtual {v1}, Ldressi/Device;->close()V
    :try_end_5f
    .catch Ljava/lang/Throwable; {:try_start_5c .. :try_end_5f} :catch_80
    .catch Ldressi/DressiException; {:try_start_5c .. :try_end_5f} :catch_60
    .catch Ljava/io/IOException; {:try_start_5c .. :try_end_5f} :catch_7e

    :goto_5f
    :try_start_5f
    throw v0
    :try_end_60
    .catch Ldressi/DressiException; {:try_start_5f .. :try_end_60} :catch_60
    .catch Ljava/io/IOException; {:try_start_5f .. :try_end_60} :catch_7e

    :catch_60
    move-exception v0

    :goto_61
    new-instance v1, Ljava/lang/StringBuilder;

    invoke-direct {v1}, Ljava/lang/StringBuilder;-><init>()V

    const-string v2, "profile: "

    invoke-virtual {v1, v2}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v0}, Ljava/lang/Exception;->getMessage()Ljava/lang/String;

    move-result-object v0

    invoke-virtual {v1, v0}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v0

    goto :goto_47

    :catch_79
    move-exception v2

    :try_start_7a
    invoke-virtual {v0, v2}, Ljava/lang/Throwable;->addSuppressed(Ljava/lang/Throwable;)V
    :try_end_7d
    .catch Ljava/lang/Throwable; {:try_start_7a .. :try_end_7d} :catch_5b
    .catch Ldressi/DressiException; {:try_start_7a .. :try_end_7d} :catch_60
    .catch Ljava/io/IOException; {:try_start_7a .. :try_end_7d} :catch_7e

    goto :goto_5a

    :catch_7e
    move-exception v0

    goto :goto_61

    :catch_80
    move-exception v1

    :try_start_81
    invoke-virtual {v0, v1}, Ljava/lang/Throwable;->addSuppressed(Ljava/lang/Throwable;)V
    :try_end_84
    .catch Ldressi/DressiException; {:try_start_81 .. :try_end_84} :catch_60
    .catch Ljava/io/IOException; {:try_start_81 .. :try_end_84} :catch_7e

    goto :goto_5f
.end method
