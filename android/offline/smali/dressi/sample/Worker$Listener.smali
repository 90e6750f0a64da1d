.class interface abstract Ldressi/sample/Worker$Listener;
.super Ljava/lang/Object;


# annotations
.annotation system Ldalvik/annotation/EnclosingClass;
    value = Ldressi/sample/Worker;
.end annotation

.annotation system Ldalvik/annotation/InnerClass;
    accessFlags = 0x608
    name = "Listener"
.end annotation


# virtual methods
.method public abstract onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V
.end method
