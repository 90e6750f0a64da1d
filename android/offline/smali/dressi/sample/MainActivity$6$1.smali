.class Ldressi/sample/MainActivity$6$1;
.super Ljava/lang/Object;

# interfaces
.implements Ljava/lang/Runnable;


# annotations
.annotation system Ldalvik/annotation/EnclosingMethod;
    value = Ldressi/sample/MainActivity$6;->run()V
.end annotation

.annotation system Ldalvik/annotation/InnerClass;
    accessFlags = 0x0
    name = null
.end annotation


# instance fields
.field final synthetic this$1:Ldressi/sample/MainActivity$6;

.field final synthetic val$text:Ljava/lang/String;


# direct methods
.method constructor <init>(Ldressi/sample/MainActivity$6;Ljava/lang/String;)V
    .registers 3
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "()V"
        }
    .end annotation

    iput-object p1, p0, Ldressi/sample/MainActivity$6$1;->this$1:Ldressi/sample/MainActivity$6;

    iput-object p2, p0, Ldressi/sample/MainActivity$6$1;->val$text:Ljava/lang/String;

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    return-void
.end method


# virtual methods
.method public run()V
    .registers 4

    iget-object v0, p0, Ldressi/sample/MainActivity$6$1;->this$1:Ldressi/sample/MainActivity$6;

    iget-object v0, v0, Ldressi/sample/MainActivity$6;->this$0:Ldressi/sample/MainActivity;

    iget-object v1, p0, Ldressi/sample/MainActivity$6$1;->val$text:Ljava/lang/String;

    const/4 v2, 0x1

    invoke-static {v0, v1, v2}, Landroid/widget/Toast;->makeText(Landroid/content/Context;Ljava/lang/CharSequence;I)Landroid/widget/Toast;

    move-result-object v0

    invoke-virtual {v0}, Landroid/widget/Toast;->show()V

    return-void
.end method
